"""Code of the user: files that are run, classes named on a command line, and results that are checked."""
