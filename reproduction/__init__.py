"""The paper's tables and figures, by its own method, by its peers and by ours; see README.md."""
