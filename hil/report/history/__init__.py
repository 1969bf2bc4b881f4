"""What earlier runs have left in a folder of results: found, followed over time, deleted with care."""
