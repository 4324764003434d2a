"""The validation: what its members count, and that they run."""
