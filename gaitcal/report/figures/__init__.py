"""Figures and sheets on paper, one module for each kind; `chart` holds what they share."""
