"""The figures of the rooms as data; draw.py and the page draw them."""
