"""How results are shown: tables, figures, the sections that order them, and the verdicts on the paper's claims."""
