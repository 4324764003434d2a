"""What `scripts/check_people.py` measures: the joints of real people, whose truth nobody knows."""
