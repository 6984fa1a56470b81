"""What makes ``tests/reference``: independent codes and the scenes they are asked."""
