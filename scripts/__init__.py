"""What stands beside the package: examples, tools of its makers, and what validates it. Run from a checkout."""
