"""The observation log: what was reported, checkpoints, replay, pruning."""
