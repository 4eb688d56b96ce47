"""Check the scenes of a folder: layout, views, sizes, temperatures, alignment of RGB and thermal."""
