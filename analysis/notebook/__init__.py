"""What `import tramstream as ts` gives to people at a desk: records, rides, estimates, figures."""
