"""The commands of the command line, by what one wants; `slam.cli` puts them together.

Everything heavy is imported inside the commands, so that help answers at once.
"""
