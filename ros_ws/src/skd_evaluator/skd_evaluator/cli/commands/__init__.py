"""The commands of `skd`, a file each: a file here is a command.

`add` gives the parser its options, and its docstring is the help; `run` does the work and returns the exit code. Help
reads all of them, so that what takes time to import stands within `run`.
"""
