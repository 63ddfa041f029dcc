"""Maps of a run: sparse landmarks, and dense surfaces fused from stereo depth."""
