"""The pose graph: incremental while driving, robust at the end. GTSAM stays in this folder."""
