"""The built-in person's walk beside that of people."""
