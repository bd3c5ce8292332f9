-- A store as the first version wrote it (sqlite3's iterdump), with the marks of its head.
PRAGMA application_id = 1096044364;
PRAGMA user_version = 1;
BEGIN TRANSACTION;
CREATE TABLE archipelagos (
    job TEXT NOT NULL REFERENCES jobs (id), variable TEXT NOT NULL, term INTEGER NOT NULL DEFAULT 0, placement BLOB,
    cut BLOB, PRIMARY KEY (job, variable)
);
INSERT INTO "archipelagos" VALUES('running','x',3,X'706C6163656D656E74',NULL);
INSERT INTO "archipelagos" VALUES('running','y',2,NULL,X'637574');
CREATE TABLE blobs (digest TEXT PRIMARY KEY, size INTEGER NOT NULL, complete INTEGER NOT NULL);
INSERT INTO "blobs" VALUES('ad875d4bcb7fa0fef5d27aadd709b8ca253b2a10d15e8283d4dc7823bf26918e',7,1);
CREATE TABLE chunks (
    digest TEXT NOT NULL REFERENCES blobs ON DELETE CASCADE, number INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (digest, number)
);
INSERT INTO "chunks" VALUES('ad875d4bcb7fa0fef5d27aadd709b8ca253b2a10d15e8283d4dc7823bf26918e',0,X'61207461626C65');
CREATE TABLE jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, name TEXT NOT NULL, spec TEXT NOT NULL,
    table_digest TEXT NOT NULL, submitted TEXT NOT NULL, state TEXT NOT NULL, reason TEXT, dataset_digest TEXT,
    elapsed REAL NOT NULL, finished TEXT, result TEXT
);
INSERT INTO "jobs" VALUES(1,'ended','an ended job','{"seed": 0, "preset": "default"}','abababababababababababababababababababababababababababababababab','2026-01-01T00:00:00Z','done',NULL,NULL,0.0,'2026-01-01T00:01:00Z','{"state": "done"}');
INSERT INTO "jobs" VALUES(2,'running','a running job','{"seed": 1, "preset": "default"}','cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd','2026-01-01T00:02:00Z','running',NULL,'efefefefefefefefefefefefefefefefefefefefefefefefefefefefefefefef',0.0,NULL,NULL);
CREATE TABLE realm (id TEXT NOT NULL, incarnation INTEGER NOT NULL);
INSERT INTO "realm" VALUES('4f2b61c09a3e',3);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('jobs',2);
COMMIT;
