"""Monte Carlo draws of parameters and marker noise, and the workers that compute them."""
