// Loads an exported LightmapGIData in Godot 4 and compares all that the engine then holds with the file.
//
//   gdibl export LEVEL.gdibl --to godot -o level.tres
//   node check.mjs level.tres GODOT [ARGUMENT…]
//
// GODOT with its arguments runs the engine with a renderer, which is what holds the numbers (`--headless` has none, and answers
// with no points): without a screen or a GPU `xvfb-run -a godot --rendering-driver vulkan --audio-driver Dummy`, with Mesa's lavapipe.
import { strict as assert } from 'node:assert';
import { spawnSync } from 'node:child_process';
import { copyFileSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

const [ file, godot, ...more ] = process.argv.slice( 2 );
const project = mkdtempSync( join( tmpdir(), 'gdibl-godot-' ) );
let output;
try {

	copyFileSync( file, join( project, 'level.tres' ) );
	copyFileSync( new URL( 'check.gd', import.meta.url ), join( project, 'check.gd' ) );
	writeFileSync( join( project, 'project.godot' ), 'config_version=5\n' );
	output = spawnSync( godot, [ ...more, '--path', project, '--script', 'check.gd' ], { encoding: 'utf8', maxBuffer: 1 << 30 } );

} finally {

	rmSync( project, { recursive: true } );

}

const line = output.stdout?.split( '\n' ).find( ( line ) => line.startsWith( '{' ) );
assert( line, `Godot printed no numbers: ${ output.error ?? '' }\n${ output.stdout }\n${ output.stderr }` );
const held = JSON.parse( line );

const text = readFileSync( file, 'utf8' );
const counts = {};
for ( const [ name, size ] of [ [ 'points', 3 ], [ 'sh', 4 ], [ 'tetrahedra', 1 ], [ 'bsp', 1 ] ] ) {

	const written = text.match( new RegExp( `"${ name }": Packed\\w+\\(([^)]*)\\)` ) )[ 1 ].split( ',' ).map( Number );
	const found = held[ name ].flat();
	assert( written.length > 0 && written.length % size === 0 );
	assert.equal( found.length, written.length, name );
	found.forEach( ( value, k ) => assert.equal( Math.fround( value ), Math.fround( written[ k ] ), `${ name }, number ${ k }` ) );
	counts[ name ] = written.length / size;

}
counts.tetrahedra /= 4;
counts.bsp /= 6;
console.log( JSON.stringify( counts ) );
