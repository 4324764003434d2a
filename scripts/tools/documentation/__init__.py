"""The documentation site: what of its pages is made from the program itself, and what holds the
pages against it.
"""
