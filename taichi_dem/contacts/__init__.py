"""Contact laws, one per file, and their composition."""
