"""Figures, pictures, and tables shared by commands. Each file appears whole or not at all."""
