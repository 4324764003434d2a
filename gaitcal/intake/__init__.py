"""A folder of recordings becomes a study: marker set, trial roles, forces, subject, labels."""
