"""What another program computed from the same recording: its curves, and how near ours are."""
