"""The cars by which figures are judged: `catalogue.CARS`."""
