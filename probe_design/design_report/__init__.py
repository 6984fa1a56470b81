"""What ``optimize`` shows and leaves: table, maps over depth and diameter, levers, fronts, report and parts."""
