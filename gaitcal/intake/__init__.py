"""From a folder of any laboratory's files to a study: what each file is, what it shows, and which lines follow."""
