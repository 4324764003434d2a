"""The published study: its protocol, Monte Carlo of parameters and noise, its tables."""
