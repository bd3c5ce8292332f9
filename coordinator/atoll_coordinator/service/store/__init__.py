"""What the coordinator still knows after its own end: one SQLite file.

``store`` is the whole interface, one transaction for each method; ``open_file`` runs these and says what room is left;
``schema`` opens, checks and migrates the file and locks its folder. A module for each group of tables, whose functions
are parts of a transaction: ``jobs``, ``archipelagos`` (terms, placements, cuts), ``checkpoint_table``
(with states), ``deaths``, ``events``, ``blobs`` (tables and datasets by digest). ``retention`` says which ended jobs
are kept.
"""
