"""The map database: one file with the frames, landmarks, loops and checkpoints of one or more sessions."""
