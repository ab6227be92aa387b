"""The notebooks: what their cells call, how they are executed, and the report made of them."""
