"""Controllers for a self-sensing film, from its fit: what they would do, with the fit's uncertainty carried through."""
