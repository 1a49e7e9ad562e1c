"""Objects of a board: SDO transfers, and procedures of them."""
