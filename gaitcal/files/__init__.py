"""Files written whole or not at all, whose they are, TOML with one-line errors, the data of the package."""
