"""SQLite and PostgreSQL: tables, statements, transactions, and what is read and written in them."""
