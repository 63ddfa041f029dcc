"""Belief (section 4.2.3 of the chapter): candidates, votes, verification and the decision about a revisit."""
