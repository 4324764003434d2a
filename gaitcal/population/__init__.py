"""What many people's results together say of the joint parameters of the next person."""
