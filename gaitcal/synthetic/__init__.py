"""People with known parameters: motions, measurements, and the truth beside them."""
