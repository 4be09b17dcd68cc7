"""The vehicle and the server: outbox, delivery, listening, the map kept on disk."""
