"""Public recordings to try the program on: which there are, and how they are fetched, checked and put into a folder."""
