"""Files to arrays in SI units and back: recordings of every format, plain safe writing, the data of
the package.
"""
