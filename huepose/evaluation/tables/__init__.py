"""The paper's tables, from the official data, beside what this code gives."""
