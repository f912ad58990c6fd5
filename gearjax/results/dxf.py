"""Drawing of a closed curve of arcs in DXF of AutoCAD 2000, the oldest version whose header can name millimetres."""

import numpy as np

DIGITS = 10  # decimal places of numbers in mm

# Group codes and values that AutoCAD requires before it opens a file. No value may contain a blank.
_HEAD = """
0 SECTION 2 HEADER
9 $ACADVER 1 AC1015 9 $HANDSEED 5 FFFF 9 $INSUNITS 70 4 9 $MEASUREMENT 70 1
9 $EXTMIN 10 {low_x} 20 {low_y} 30 0.0 9 $EXTMAX 10 {high_x} 20 {high_y} 30 0.0
0 ENDSEC
0 SECTION 2 CLASSES 0 ENDSEC
0 SECTION 2 TABLES
0 TABLE 2 VPORT 5 1 330 0 100 AcDbSymbolTable 70 0 0 ENDTAB
0 TABLE 2 LTYPE 5 2 330 0 100 AcDbSymbolTable 70 3
0 LTYPE 5 10 330 2 100 AcDbSymbolTableRecord 100 AcDbLinetypeTableRecord 2 ByBlock 70 0 3 none 72 65 73 0 40 0.0
0 LTYPE 5 11 330 2 100 AcDbSymbolTableRecord 100 AcDbLinetypeTableRecord 2 ByLayer 70 0 3 none 72 65 73 0 40 0.0
0 LTYPE 5 12 330 2 100 AcDbSymbolTableRecord 100 AcDbLinetypeTableRecord 2 Continuous 70 0 3 solid 72 65 73 0 40 0.0
0 ENDTAB
0 TABLE 2 LAYER 5 3 330 0 100 AcDbSymbolTable 70 2
0 LAYER 5 13 330 3 100 AcDbSymbolTableRecord 100 AcDbLayerTableRecord 2 0 70 0 62 7 6 Continuous 370 -3 390 1F
0 LAYER 5 14 330 3 100 AcDbSymbolTableRecord 100 AcDbLayerTableRecord 2 {layer} 70 0 62 7 6 Continuous 370 -3 390 1F
0 ENDTAB
0 TABLE 2 STYLE 5 4 330 0 100 AcDbSymbolTable 70 1
0 STYLE 5 15 330 4 100 AcDbSymbolTableRecord 100 AcDbTextStyleTableRecord
2 Standard 70 0 40 0.0 41 1.0 50 0.0 71 0 42 2.5 3 txt
0 ENDTAB
0 TABLE 2 VIEW 5 6 330 0 100 AcDbSymbolTable 70 0 0 ENDTAB
0 TABLE 2 UCS 5 7 330 0 100 AcDbSymbolTable 70 0 0 ENDTAB
0 TABLE 2 APPID 5 8 330 0 100 AcDbSymbolTable 70 1
0 APPID 5 16 330 8 100 AcDbSymbolTableRecord 100 AcDbRegAppTableRecord 2 ACAD 70 0
0 ENDTAB
0 TABLE 2 DIMSTYLE 5 9 330 0 100 AcDbSymbolTable 70 1 100 AcDbDimStyleTable
0 DIMSTYLE 105 17 330 9 100 AcDbSymbolTableRecord 100 AcDbDimStyleTableRecord 2 Standard 70 0
0 ENDTAB
0 TABLE 2 BLOCK_RECORD 5 A 330 0 100 AcDbSymbolTable 70 2
0 BLOCK_RECORD 5 18 330 A 100 AcDbSymbolTableRecord 100 AcDbBlockTableRecord 2 *Model_Space 340 1D
0 BLOCK_RECORD 5 19 330 A 100 AcDbSymbolTableRecord 100 AcDbBlockTableRecord 2 *Paper_Space 340 1E
0 ENDTAB
0 ENDSEC
0 SECTION 2 BLOCKS
0 BLOCK 5 20 330 18 100 AcDbEntity 8 0 100 AcDbBlockBegin 2 *Model_Space 70 0 10 0.0 20 0.0 30 0.0 3 *Model_Space
0 ENDBLK 5 21 330 18 100 AcDbEntity 8 0 100 AcDbBlockEnd
0 BLOCK 5 22 330 19 100 AcDbEntity 67 1 8 0 100 AcDbBlockBegin 2 *Paper_Space 70 0
10 0.0 20 0.0 30 0.0 3 *Paper_Space
0 ENDBLK 5 23 330 19 100 AcDbEntity 67 1 8 0 100 AcDbBlockEnd
0 ENDSEC
0 SECTION 2 ENTITIES
0 LWPOLYLINE 5 24 330 18 100 AcDbEntity 8 {layer} 100 AcDbPolyline 90 {vertices} 70 1 43 0.0
"""
_TAIL = """
0 ENDSEC
0 SECTION 2 OBJECTS
0 DICTIONARY 5 C 330 0 100 AcDbDictionary 281 1 3 ACAD_GROUP 350 D 3 ACAD_LAYOUT 350 1A 3 ACAD_PLOTSTYLENAME 350 E
0 DICTIONARY 5 D 330 C 100 AcDbDictionary 281 1
0 DICTIONARY 5 1A 330 C 100 AcDbDictionary 281 1 3 Model 350 1D 3 Layout1 350 1E
0 LAYOUT 5 1D 330 1A 100 AcDbPlotSettings 70 1024 100 AcDbLayout 1 Model 70 1 71 0 330 18
0 LAYOUT 5 1E 330 1A 100 AcDbPlotSettings 70 0 100 AcDbLayout 1 Layout1 70 1 71 1 330 19
0 ACDBDICTIONARYWDFLT 5 E 330 C 100 AcDbDictionary 281 1 3 Normal 350 1F 100 AcDbDictionaryWithDefault 340 1F
0 ACDBPLACEHOLDER 5 1F 330 E
0 ENDSEC
0 EOF
"""


def drawing(points: np.ndarray, bulges: np.ndarray, layer: str) -> str:
    """The text of a DXF drawing in mm with one closed polyline of arcs.

    Args:
        points: vertices, shape (n, 2) [mm].
        bulges: tangent of a quarter of the angle of the arc from each vertex to the next, positive if the arc runs
            counter-clockwise, shape (n,).
        layer: name of the layer, without blanks.
    """
    low_x, low_y, high_x, high_y = (f"{edge:.6f}" for edge in (*points.min(axis=0), *points.max(axis=0)))
    words = {"low_x": low_x, "low_y": low_y, "high_x": high_x, "high_y": high_y}
    head = _HEAD.format(**words, layer=layer, vertices=len(points))
    vertices = [
        f"10\n{x:.{DIGITS}f}\n20\n{y:.{DIGITS}f}\n42\n{bulge:.15g}"
        for (x, y), bulge in zip(points.tolist(), bulges.tolist(), strict=True)
    ]
    return "\n".join([*head.split(), *vertices, *_TAIL.split()]) + "\n"
