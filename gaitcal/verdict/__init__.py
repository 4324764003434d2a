"""How far a result can be believed: what its own figures say against it, which fault explains them, and the verdict."""
