"""The study of 2007 again: its tables and claims beside ours."""
