"""The commands of the command line, one module for each group of them; `slam.cli.app` registers them.

Everything heavy is imported inside the commands, so that help answers at once.
"""
