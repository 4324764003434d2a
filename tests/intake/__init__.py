"""Two results of one person side by side."""
