"""What every package uses: errors, files that appear whole or not at all, text files."""
