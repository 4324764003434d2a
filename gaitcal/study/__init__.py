"""Read and check study files, their trials, priors and known truth."""
