"""The seven domains of the paper, one module each, behind one lookup."""
