"""The shipped procedures: each is a script or a package; they also serve as examples."""
