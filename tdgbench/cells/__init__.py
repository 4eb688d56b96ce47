"""What a finished cell keeps in its folder, and the one way to read it."""
