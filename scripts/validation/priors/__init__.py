"""Made-up populations, their recordings, and what priors learnt of some of them do for others."""
