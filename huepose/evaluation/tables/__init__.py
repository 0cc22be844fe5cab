"""The paper's tables from the official data, with the figures of this code beside them."""
