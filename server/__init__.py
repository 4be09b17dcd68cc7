"""The obstacle service: the obstacle's life, storage, nearby queries, push."""
