"""Archives of data sets: read, checked before anything is unpacked, unpacked whole or not at all."""
