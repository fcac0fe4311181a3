"""Self-sensing: force from capacitance, electrodes, gains of the loop, wrinkling."""
