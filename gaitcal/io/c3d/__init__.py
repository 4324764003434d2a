"""C3D files: their layout, their force plates, reading and writing."""
