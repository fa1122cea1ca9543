"""What a discovery returns, saves and prints."""
