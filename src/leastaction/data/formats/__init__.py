"""What stands behind `leastaction.io`: one module for each kind of file, and one for what they share."""
