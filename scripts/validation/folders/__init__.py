"""Result folders under attack: what is done to them, and what must be true of them afterwards."""
