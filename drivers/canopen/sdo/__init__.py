"""SDO transfers with a board, and procedures made of them."""
