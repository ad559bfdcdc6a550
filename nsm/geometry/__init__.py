"""Volumes, surfaces, distances and topology of shapes known as functions; nothing here knows a network."""
