"""From results (frozen dataclasses) to rows of the contract's tables (arrow). Nothing is computed here."""
