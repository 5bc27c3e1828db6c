// Imports what `gdibl export --to unity` writes. Put this file into a folder named Editor. In the menu Tools > gdibl:
//
//   1. "Create Light Probe Group" makes a group with a probe at each position.
//   2. Window > Rendering > Lighting > Generate Lighting: Unity makes the tetrahedra (its own light does not matter,
//      the lowest settings do).
//   3. "Set Probe Light" puts the light of the file into the probes, and says how many it found.
//
// Generating again takes Unity's own light: then do step 3 again.
using System.Collections.Generic;
using System.IO;
using UnityEditor;
using UnityEngine;
using UnityEngine.Rendering;

public static class GdiblImporter
{
    [System.Serializable]
    class Probes
    {
        public string format;
        public int version;
        public float[] positions;
        public float[] coefficients;
    }

    [MenuItem("Tools/gdibl/Create Light Probe Group")]
    static void CreateGroup()
    {
        Probes probes = Read();
        if (probes == null) return;
        var positions = new Vector3[probes.positions.Length / 3];
        for (int i = 0; i < positions.Length; i++) positions[i] = Position(probes, i);
        var made = new GameObject("gdibl light probes", typeof(LightProbeGroup));
        made.GetComponent<LightProbeGroup>().probePositions = positions;
        Undo.RegisterCreatedObjectUndo(made, "Create Light Probe Group");
    }

    [MenuItem("Tools/gdibl/Set Probe Light")]
    static void SetLight()
    {
        Probes probes = Read();
        if (probes == null) return;
        LightProbes baked = LightmapSettings.lightProbes;
        if (baked == null)
        {
            Debug.LogError("gdibl: the scene has no baked light probes; generate lighting first");
            return;
        }
        var places = new Dictionary<Vector3Int, int>();
        for (int i = 0; i < probes.positions.Length / 3; i++) places[Millimetres(Position(probes, i))] = i;

        Vector3[] positions = baked.positions;
        SphericalHarmonicsL2[] light = baked.bakedProbes;
        int found = 0;
        for (int probe = 0; probe < positions.Length; probe++)
        {
            if (!places.TryGetValue(Millimetres(positions[probe]), out int i)) continue;
            for (int channel = 0; channel < 3; channel++)
                for (int k = 0; k < 9; k++)
                    light[probe][channel, k] = probes.coefficients[27 * i + 9 * channel + k];
            found++;
        }
        baked.bakedProbes = light;
        EditorUtility.SetDirty(baked);
        Debug.Log($"gdibl: set the light of {found} of {positions.Length} probes");
    }

    static Probes Read()
    {
        string path = EditorUtility.OpenFilePanel("Light probes of gdibl", "Assets", "json");
        if (string.IsNullOrEmpty(path)) return null;
        var probes = JsonUtility.FromJson<Probes>(File.ReadAllText(path));
        if (probes.format == "gdibl light probes" && probes.version == 1) return probes;
        Debug.LogError($"{path}: not light probes of gdibl, version 1");
        return null;
    }

    static Vector3 Position(Probes probes, int i) =>
        new Vector3(probes.positions[3 * i], probes.positions[3 * i + 1], probes.positions[3 * i + 2]);

    static Vector3Int Millimetres(Vector3 position) => Vector3Int.RoundToInt(position * 1000f);
}
