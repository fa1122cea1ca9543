"""What studies/ and reproduction/ share: where records are kept, processes, and the course of runs."""
