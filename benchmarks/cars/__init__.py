"""Cars that no sweep of the basic car contains, for the ranking benchmark."""
