"""The page of a result: body in motion, curves and tables in one self-contained file that needs no
network.
"""
