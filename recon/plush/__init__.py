"""The PLUSH dataset's two folders, a recording and its reconstruction, both ways."""
