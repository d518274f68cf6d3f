"""What proves the experiments: on bodies of known truth, over seeds."""
