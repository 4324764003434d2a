"""Whole studies: a person from files, synthetic subjects, the published study."""
