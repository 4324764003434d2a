"""Ground reactions on feet, inverse dynamics and its derivatives."""
