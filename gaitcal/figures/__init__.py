"""One module for each kind of figure; `style` and `chart` hold what they share."""
