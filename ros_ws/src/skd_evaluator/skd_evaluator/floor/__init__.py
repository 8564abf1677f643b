"""How little it takes to hit a car: what the best kamikaze could have done, and what any search has found."""
