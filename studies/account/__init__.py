"""What is the 65 % of the paper made of: accounts of where the rest went."""
