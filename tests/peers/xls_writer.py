"""Writes what comes in as CSV with the columns t, op and pv as a workbook of Excel 97 (.xls), to standard output."""

import sys

import xlwt

book = xlwt.Workbook()
sheet = book.add_sheet("Trend")
stamp = xlwt.easyxf(num_format_str="yyyy-mm-dd hh:mm:ss")
sheet.write(0, 0, "Trend of unit 10")
for column, name in enumerate(["Time", "OP %", "PV"]):
    sheet.write(2, column, name)
for row, line in enumerate(sys.stdin, 3):
    t, op, pv = map(float, line.split(","))
    # A number with a date's format, which is what a date is here; xlwt's own dates have whole seconds.
    sheet.write(row, 0, t / 86_400 + 25_569, stamp)
    sheet.write(row, 1, op)
    sheet.write(row, 2, pv)
book.save(sys.stdout.buffer)
