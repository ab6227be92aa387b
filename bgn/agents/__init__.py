"""The six agents of the paper as declarations, their networks, and the A2C update that trains them."""
