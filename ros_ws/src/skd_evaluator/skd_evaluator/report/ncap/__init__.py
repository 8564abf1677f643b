"""The regulator's view as people see it: tables of the terminal, a picture, a page, and a part of a report."""
