# Prints as JSON what Godot has of res://level.tres, a LightmapGIData: see check.mjs, which calls it.
extends SceneTree

func _init():
	var data = load("res://level.tres")
	if not data is LightmapGIData:
		printerr("found ", data, ", expected a LightmapGIData")
		quit(1)
		return
	# Asks the renderer, which holds the numbers.
	var probes = data.get("probe_data")
	var flat = func(values, parts): return Array(values).map(parts)
	print(JSON.stringify({
		"points": flat.call(probes.points, func(p): return [p.x, p.y, p.z]),
		"sh": flat.call(probes.sh, func(c): return [c.r, c.g, c.b, c.a]),
		"tetrahedra": Array(probes.tetrahedra),
		"bsp": Array(probes.bsp),
	}, "", true, true))
	quit()
