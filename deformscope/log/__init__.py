"""A twin for every stage: the only place with rerun archetypes. Nothing here computes."""
