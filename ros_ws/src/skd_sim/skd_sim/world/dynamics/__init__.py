"""How the car moves: the paper's basic car, or a multi-body model of a real one, behind one interface."""
