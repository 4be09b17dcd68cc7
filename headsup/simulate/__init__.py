"""`headsup simulate`: the dataset generator's commands."""
