"""What a drive is, as data: dictionaries, units, states and the profiles of drive families."""
