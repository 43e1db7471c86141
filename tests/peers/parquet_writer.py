"""Writes a record (CSV with t, op, pv and sp) as Parquet files into a folder, with pandas, pyarrow and DuckDB.

parquet_writer.py CSV FOLDER
tests/exports/written.rs says what each file holds.
"""

import sys
from decimal import Decimal

import duckdb
import numpy
import pandas
import pyarrow
import pyarrow.parquet

csv, folder = sys.argv[1:]
# 2026-06-01 06:00:00 UTC.
BEGIN = "2026-06-01 06:00:00"

example = pandas.read_csv(csv)
milliseconds = (example.pop("t") * 1000).round().astype("int64")
stamps = pandas.Timestamp(BEGIN) + pandas.to_timedelta(milliseconds, unit="ms")
record = example.assign(time=stamps.dt.as_unit("us"))[["time", "op", "pv", "sp"]]
row = numpy.arange(len(record))
modes = numpy.where(row < 900, "AUTO", "MAN")
qualities = numpy.where(row % 100 == 7, "Bad", "Good")
# Where nothing was measured.
no_op, no_pv, no_sp, no_mode = row % 50 == 3, row % 50 == 5, row % 10 != 0, row % 50 == 9


def path(name):
    return f"{folder}/{name}.parquet"


def by_pandas(name, frame, **options):
    frame.to_parquet(path(f"pandas-{name}"), engine="pyarrow", **options)


def by_arrow(name, frame, schema=None, **options):
    table = pyarrow.Table.from_pandas(frame, schema=schema, preserve_index=False)
    pyarrow.parquet.write_table(table, path(f"arrow-{name}"), **options)


def text(value):
    """A text as SQL has it."""
    return "'" + str(value).replace("'", "''") + "'"


def decimals(values):
    return values.map(lambda value: Decimal(f"{value:.3f}"))


def all_of_pandas():
    by_pandas("default", record)
    for compression in ["gzip", "brotli", "lz4", "zstd"]:
        by_pandas(compression, record, compression=compression)
    by_pandas("uncompressed", record, compression=None)
    for unit in ["s", "ms", "us", "ns"]:
        by_pandas(f"stamps-{unit}", record.assign(time=record.time.dt.as_unit(unit)))
    by_pandas("int96", record, use_deprecated_int96_timestamps=True)

    values = record.drop(columns="time")
    index = pandas.DatetimeIndex(record.time).rename(None)
    by_pandas("index", values.set_index(index))
    by_pandas("index-zone", values.set_index(index.tz_localize("UTC").tz_convert("Europe/Berlin")))
    # Rows that were chosen from a longer table keep their numbers; even ones would be kept as a range beside the columns.
    by_pandas("index-numbers", record.set_index(pandas.Index(row + row // 7 + 10)))

    by_pandas("decimal", record.assign(op=decimals(record.op), pv=decimals(record.pv)))
    by_pandas("float16", record.astype({"op": "float16", "pv": "float16"}))
    by_pandas("float32", record.astype({"op": "float32", "pv": "float32"}))
    by_pandas("texts", record.assign(mode=modes, pv_status=qualities))
    words = {"mode": pandas.Categorical(modes), "pv_status": pandas.Categorical(qualities)}
    by_pandas("categories", record.assign(**words))
    nullable = {
        "op": record.op.astype("Float64").mask(no_op),
        "pv": record.pv.astype("Float64").mask(no_pv),
        "sp": record.sp.astype("Float64").mask(no_sp),
        "mode": pandas.Series(modes == "AUTO").astype("Int64").mask(no_mode),
    }
    by_pandas("nullable", record.assign(**nullable))
    by_pandas("nullable-v2", record.assign(**nullable), data_page_version="2.0")


def all_of_arrow():
    by_arrow("row-groups", record, row_group_size=100)
    words = record.assign(mode=modes, pv_status=qualities)
    # So short that a column has several.
    pages = {"data_page_size": 256, "write_batch_size": 64}
    by_arrow("pages-v2", words, data_page_version="2.0", compression="zstd", **pages)
    by_arrow("no-dictionary", words, use_dictionary=False)
    delta = {
        "time": "DELTA_BINARY_PACKED",
        "op": "BYTE_STREAM_SPLIT",
        "pv": "BYTE_STREAM_SPLIT",
        "mode": "DELTA_BYTE_ARRAY",
        "pv_status": "DELTA_LENGTH_BYTE_ARRAY",
    }
    by_arrow("encodings", words, use_dictionary=False, column_encoding=delta)

    stamp = ("time", pyarrow.timestamp("us"))

    def typed(op, pv):
        return pyarrow.schema([stamp, ("op", op), ("pv", pv), ("sp", pyarrow.float64())])

    exact = record.assign(op=decimals(record.op), pv=decimals(record.pv))
    by_arrow("decimal-fixed", exact, typed(pyarrow.decimal128(9, 3), pyarrow.decimal128(38, 3)))
    narrow = typed(pyarrow.decimal128(9, 3), pyarrow.decimal128(18, 3))
    by_arrow("decimal-integer", exact, narrow, store_decimal_as_integer=True)
    # pyarrow refuses a decimal that it would have to round, so that it is rounded before.
    rounded = exact.assign(**{name: exact[name].map(lambda value: round(value, 2)) for name in ["op", "pv"]})
    by_arrow("decimal-rounded", rounded, typed(pyarrow.decimal128(9, 2), pyarrow.decimal128(9, 2)))

    # NaN itself: pandas makes nulls of it.
    empty = {"op": no_op, "pv": no_pv, "sp": no_sp}
    columns = {name: pyarrow.array(record[name].mask(no).to_numpy()) for name, no in empty.items()}
    columns = {"time": pyarrow.array(record.time), **columns}
    pyarrow.parquet.write_table(pyarrow.table(columns), path("arrow-nan"))

    tags = {name: f"FIC101.{name.upper()}" for name in ["op", "pv", "sp"]}
    rows = record.rename(columns=tags).melt(id_vars="time", var_name="tag", value_name="value")
    # Sample by sample, as a historian writes, and not tag by tag.
    rows = rows.sort_values("time", kind="stable").astype({"tag": "category"})
    by_arrow("long", rows[["tag", "time", "value"]])


def all_of_duckdb():
    # Nothing is fetched from elsewhere.
    local = {"autoinstall_known_extensions": False, "threads": 1}
    with duckdb.connect(config=local) as database:
        database.execute("SET TimeZone = 'UTC'")
        # As decimals, so that DuckDB rounds the digits that stand there where a type has fewer.
        types = {name: "DECIMAL(9, 3)" for name in ["t", "op", "pv", "sp"]}
        database.execute(
            f"CREATE TABLE record AS SELECT row_number() OVER (ORDER BY t) - 1 AS row, op, pv, sp, "
            f"TIMESTAMP {text(BEGIN)} + to_milliseconds((t * 1000)::BIGINT) AS time "
            f"FROM read_csv({text(csv)}, types = {types})"
        )

        def copy(name, columns, options="", source="record ORDER BY row"):
            to = text(path(f"duckdb-{name}"))
            database.execute(f"COPY (SELECT {columns} FROM {source}) TO {to} (FORMAT parquet{options})")

        def values(kind):
            return ", ".join(f"{name}::{kind} AS {name}" for name in ["op", "pv", "sp"])

        doubles = values("DOUBLE")
        # The CSV as DuckDB reads it by itself.
        copy("csv", "*", source=f"read_csv({text(csv)})")
        for compression in ["snappy", "gzip", "brotli", "lz4", "zstd", "uncompressed"]:
            copy(compression, f"time, {doubles}", f", COMPRESSION {compression}")
        for kind in ["TIMESTAMPTZ", "TIMESTAMP_S", "TIMESTAMP_MS", "TIMESTAMP_NS"]:
            copy(kind.lower().replace("_", "-"), f"time::{kind} AS time, {doubles}")
        copy("date-and-time", f"time::DATE AS date, time::TIME AS time, {doubles}")
        for digits in ["9, 3", "18, 3", "38, 3", "9, 2"]:
            copy("decimal-" + digits.replace(", ", "-"), f"time, {values(f'DECIMAL({digits})')}")
        copy("float", f"time, {values('FLOAT')}")
        mode = "if(row < 900, 'AUTO', 'MAN')::ENUM ('AUTO', 'MAN') AS mode"
        words = f"time, {doubles}, {mode}, if(row % 100 = 7, 'Bad', 'Good') AS pv_status"
        copy("enum", words)
        copy("v2", words, ", PARQUET_VERSION V2, COMPRESSION zstd")
        tags = ", ".join(f'{name}::DOUBLE AS "FIC101.{name.upper()}"' for name in ["op", "pv", "sp"])
        wide = f"(SELECT row, time::TIMESTAMPTZ AS time, {tags} FROM record)"
        rows = f"(UNPIVOT {wide} ON COLUMNS('FIC101.*') INTO NAME tag VALUE value) ORDER BY row, tag"
        copy("long", "tag, time, value", source=rows)


all_of_pandas()
all_of_arrow()
all_of_duckdb()
