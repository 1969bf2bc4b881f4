"""Cross-checks of the bench file: what measurements at rest say about its parameters."""
