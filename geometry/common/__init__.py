"""What every room uses: errors, files that appear whole or not at all, text files."""
