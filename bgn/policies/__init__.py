"""Who acts on a history: random, scripted and saved policies behind one protocol."""
