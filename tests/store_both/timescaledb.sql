-- Stands in for TimescaleDB, which Debian does not have: an extension by name only, and functions with the names, arguments and
-- meaning of its own, as far as they are called. What a hypertable does inside it does not show.
SET allow_system_table_mods TO on;
INSERT INTO pg_extension (oid, extname, extowner, extnamespace, extrelocatable, extversion)
    VALUES (99999, 'timescaledb', 10, 'public'::regnamespace, false, '0');
CREATE TABLE public.hypertables (relation oid PRIMARY KEY, name text, time_column name, span interval, default_indexes boolean);
CREATE TABLE public.dropped (name text, older_than timestamptz);
CREATE FUNCTION public.create_hypertable(
    relation regclass, time_column_name name, partitioning_column name = NULL, number_partitions integer = NULL,
    chunk_time_interval interval = NULL, create_default_indexes boolean = true) RETURNS SETOF record LANGUAGE plpgsql AS $$
BEGIN
    IF (SELECT relkind FROM pg_class WHERE oid = relation) <> 'r' THEN RAISE 'table is already partitioned'; END IF;
    IF EXISTS (SELECT 1 FROM pg_index JOIN pg_attribute ON attrelid = relation AND attname = time_column_name
        WHERE indrelid = relation AND indisunique AND NOT attnum = ANY (indkey)) THEN
        RAISE 'cannot create a unique index without the column %', time_column_name;
    END IF;
    INSERT INTO public.hypertables VALUES (relation, (SELECT relname FROM pg_class WHERE oid = relation), time_column_name, chunk_time_interval, create_default_indexes);
    RETURN;
END $$;
CREATE FUNCTION public.hypertable_size(hypertable regclass) RETURNS bigint LANGUAGE sql AS $$
    SELECT pg_total_relation_size(hypertable) FROM public.hypertables AS own WHERE own.relation = hypertable
$$;
-- Chunks go whole, and only those that end at or before the time.
CREATE FUNCTION public.drop_chunks(relation regclass, older_than timestamptz) RETURNS SETOF text LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO public.dropped VALUES ((SELECT relname FROM pg_class WHERE oid = relation), older_than);
    EXECUTE format('DELETE FROM %s WHERE at < date_bin(%L, %L, timestamptz ''epoch'')', relation,
        (SELECT own.span FROM public.hypertables AS own WHERE own.relation = drop_chunks.relation), older_than);
    RETURN;
END $$;
