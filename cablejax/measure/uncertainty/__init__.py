"""How well the diameter is known: errors that points share, stations that do not fit, and the budget."""
