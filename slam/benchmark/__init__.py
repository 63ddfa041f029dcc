"""Many runs as one: every source with every paradigm, back end and seed, on as many processes as there are."""
