"""Figures, one file each. They draw on figures of their own and never touch matplotlib's global state."""
