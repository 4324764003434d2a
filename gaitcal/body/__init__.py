"""What a body is like: lengths, rigid clusters, joints between them, and which one fault would explain what is odd."""
