"""What stands in the simulated town: streets, houses, vegetation, vehicles, and their materials."""
