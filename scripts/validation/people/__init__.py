"""The joints of real people, whose truth nobody knows."""
