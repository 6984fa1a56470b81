"""The programs that make ``tests/reference``: independent codes and their scenes."""
