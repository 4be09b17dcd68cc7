"""Obstacles on their way out: nearby queries from memory, searches, pages."""
