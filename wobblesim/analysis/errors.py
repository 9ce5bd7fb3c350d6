"""What stops a figure or a statistic, in the words of the user."""


class FigureError(Exception):
    """A figure that this study does not have the data for; the message is one sentence with its remedy."""
