"""Figures and sheets on paper, one module for each kind; `chart` holds the common parts."""
