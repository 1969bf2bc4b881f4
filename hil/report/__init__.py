"""HTML pages and figures of results."""
