"""The regulator's view: Euro NCAP's grids of test speeds and impact places, with the margin beside each colour."""
