"""Streets as plain descriptions: roads, what is worn into them, ways through them and traffic."""
