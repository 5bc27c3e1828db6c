// Shows exports of gdibl in three.js (headless Chromium, software GL, both renderers) and compares every pixel of three
// spheres with `gdibl sample` at the same points: albedo / π · E, exposed, in sRGB. Bound: 3 % of white on average.
//
//   cargo build --release          (in the repository)
//   npm install                    (here)
//   node check.mjs                 pictures and figures go into out/
//
// CHROMIUM names the browser [/usr/bin/chromium], GDIBL the program [../../target/release/gdibl].
// Then the same in light from one side alone, for each of the six: that side, and no other, must be bright.
import { execFileSync } from 'node:child_process';
import { createServer } from 'node:http';
import { existsSync, mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { extname, join, normalize } from 'node:path';
import { chromium } from 'playwright-core';

const here = import.meta.dirname;
const out = join( here, 'out' );
const repository = join( here, '../..' );
const gdibl = process.env.GDIBL ?? join( repository, 'target/release/gdibl' );
const [ width, height ] = [ 640, 480 ];
const BOUND = 0.03;
const SIDES = { '+x': [ 1, 0, 0 ], '-x': [ - 1, 0, 0 ], '+y': [ 0, 1, 0 ], '-y': [ 0, - 1, 0 ], '+z': [ 0, 0, 1 ], '-z': [ 0, 0, - 1 ] };

const run = ( ...parameters ) => execFileSync( gdibl, parameters, { cwd: out, encoding: 'utf8', stdio: [ 'ignore', 'pipe', 'inherit' ], maxBuffer: 1 << 28 } );
const dot = ( a, b ) => a[ 0 ] * b[ 0 ] + a[ 1 ] * b[ 1 ] + a[ 2 ] * b[ 2 ];
const minus = ( a, b ) => a.map( ( v, k ) => v - b[ k ] );
const unit = ( a ) => a.map( ( v ) => v / Math.hypot( ...a ) );
const cross = ( a, b ) => [ a[ 1 ] * b[ 2 ] - a[ 2 ] * b[ 1 ], a[ 2 ] * b[ 0 ] - a[ 0 ] * b[ 2 ], a[ 0 ] * b[ 1 ] - a[ 1 ] * b[ 0 ] ];
const srgb = ( v ) => 255 * ( v <= 0.0031308 ? 12.92 * v : 1.055 * v ** ( 1 / 2.4 ) - 0.055 );

// Where each pixel's ray meets the nearest sphere: pixel, position, normal. Pixels at a rim are left out: there one
// picture may see the sphere, and the other what is behind.
function spherePoints( { spheres, radius, eye, target, fov } ) {

	const forward = unit( minus( target, eye ) );
	const right = unit( cross( forward, [ 0, 1, 0 ] ) );
	const up = cross( right, forward );
	const scale = Math.tan( fov * Math.PI / 360 );
	const hits = [];
	for ( let i = 0; i < width * height; i ++ ) {

		const x = ( 2 * ( ( i % width ) + 0.5 ) / width - 1 ) * scale * width / height;
		const y = ( 1 - 2 * ( Math.floor( i / width ) + 0.5 ) / height ) * scale;
		const direction = unit( forward.map( ( f, k ) => f + x * right[ k ] + y * up[ k ] ) );
		let nearest = null;
		spheres.forEach( ( centre, sphere ) => {

			const to = minus( eye, centre );
			const b = dot( to, direction );
			const d = b * b - dot( to, to ) + radius * radius;
			const t = - b - Math.sqrt( d );
			if ( d > 0 && t > 0 && ! ( nearest?.t < t ) ) nearest = { t, sphere, pixel: i };

		} );
		hits.push( nearest );
		if ( nearest ) {

			nearest.position = eye.map( ( e, k ) => e + nearest.t * direction[ k ] );
			nearest.normal = unit( minus( nearest.position, spheres[ nearest.sphere ] ) );

		}

	}

	const inner = ( hit ) => [ - 1, 1, - width, width ].every( ( step ) => hits[ hit.pixel + step ]?.sphere === hit.sphere );
	return hits.filter( ( hit ) => hit && inner( hit ) );

}

// E of gdibl itself.
function irradiance( volume, points ) {

	writeFileSync( join( out, 'points.csv' ), points.map( ( p ) => [ ...p.position, ...p.normal ].join() ).join( '\n' ) );
	const rows = run( 'sample', volume, '--at', 'points.csv' ).trim().split( '\n' ).slice( 1 );
	if ( rows.length !== points.length ) throw new Error( `${ rows.length } answers for ${ points.length } points` );
	return rows.map( ( row ) => row.split( ',' ).slice( 6, 9 ).map( Number ) );

}

// A Radiance picture, lat-long, bright within 30° around one direction.
function lamp( direction, path ) {

	const [ w, h ] = [ 128, 64 ];
	const bytes = [];
	for ( let i = 0; i < w * h; i ++ ) {

		const longitude = 2 * Math.PI * ( 0.5 - ( i % w + 0.5 ) / w );
		const latitude = Math.PI * ( 0.5 - ( Math.floor( i / w ) + 0.5 ) / h );
		const there = [ Math.sin( longitude ) * Math.cos( latitude ), Math.sin( latitude ), Math.cos( longitude ) * Math.cos( latitude ) ];
		bytes.push( ...( dot( there, direction ) > Math.cos( Math.PI / 6 ) ? [ 128, 128, 128, 129 ] : [ 0, 0, 0, 0 ] ) );

	}

	writeFileSync( path, Buffer.concat( [ Buffer.from( `#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y ${ h } +X ${ w }\n` ), Buffer.from( bytes ) ] ) );

}

function prepare() {

	mkdirSync( out, { recursive: true } );
	run( 'bake', join( repository, 'assets/uffizi-box/uffizi-box.bake.toml' ), '-o', 'box.gdibl', '--quiet' );
	run( 'export', 'box.gdibl', '--to', 'three', '-o', 'box.bin' );
	writeFileSync( join( out, 'box.glb' ), readFileSync( join( repository, 'assets/uffizi-box/uffizi-box.glb' ) ) );
	writeFileSync( join( out, 'nothing.gltf' ), JSON.stringify( { asset: { version: '2.0' }, scene: 0, scenes: [ {} ] } ) );
	for ( const [ side, direction ] of Object.entries( SIDES ) ) {

		lamp( direction, join( out, 'lamp.hdr' ) );
		run( 'bake', 'nothing.gltf', '--distant', 'lamp.hdr', '--bounds', '-3,-2,-2,3,2,2', '--counts', '4,3,2', '-o', `side${ side }.gdibl`, '--quiet' );
		run( 'export', `side${ side }.gdibl`, '--to', 'three', '-o', `side${ side }.bin` );

	}

}

function serve() {

	const types = { '.html': 'text/html', '.js': 'text/javascript' };
	const server = createServer( ( request, response ) => {

		const path = join( here, normalize( decodeURIComponent( new URL( request.url, 'http://x' ).pathname ) ) );
		if ( ! existsSync( path ) ) return response.writeHead( 404 ).end();
		response.writeHead( 200, { 'content-type': types[ extname( path ) ] ?? 'application/octet-stream' } ).end( readFileSync( path ) );

	} );
	return new Promise( ( resolve ) => server.listen( 0, '127.0.0.1', () => resolve( server ) ) );

}

// The picture that gdibl's own light makes, and three.js', one above the other.
async function compare( page, name, view, volume ) {

	const points = spherePoints( view );
	const light = irradiance( volume, points );
	const bright = light.flat().sort( ( a, b ) => a - b )[ Math.floor( 0.99 * 3 * light.length ) ];
	const seen = { ...view, exposure: 0.95 / ( view.albedo / Math.PI * bright ) };
	const bottomUp = Buffer.from( await page.evaluate( ( seen ) => window.show( seen ), seen ), 'base64' );
	const row = ( y ) => bottomUp.subarray( 4 * width * ( height - 1 - y ), 4 * width * ( height - y ) );
	const pixels = Buffer.concat( Array.from( { length: height }, ( _, y ) => row( y ) ) );
	const expected = new Uint8ClampedArray( 4 * width * height ).fill( 255 );
	const differences = view.spheres.map( () => ( { sum: 0, count: 0 } ) );
	points.forEach( ( point, i ) => light[ i ].forEach( ( e, c ) => {

		const value = srgb( Math.min( 1, Math.max( 0, seen.exposure * view.albedo / Math.PI * e ) ) );
		expected[ 4 * point.pixel + c ] = value;
		const of = differences[ point.sphere ];
		of.sum += Math.abs( value - pixels[ 4 * point.pixel + c ] ) / 255;
		of.count ++;

	} ) );
	await page.locator( '#picture' ).screenshot( { path: join( out, `${ name }.png` ) } );
	const url = await page.evaluate( ( { expected, width, height } ) => {

		const canvas = Object.assign( document.createElement( 'canvas' ), { width, height } );
		canvas.getContext( '2d' ).putImageData( new ImageData( Uint8ClampedArray.from( atob( expected ), ( byte ) => byte.charCodeAt( 0 ) ), width, height ), 0, 0 );
		return canvas.toDataURL();

	}, { expected: Buffer.from( expected ).toString( 'base64' ), width, height } );
	writeFileSync( join( out, `${ name }.expected.png` ), Buffer.from( url.split( ',' )[ 1 ], 'base64' ) );
	const total = differences.reduce( ( all, of ) => ( { sum: all.sum + of.sum, count: all.count + of.count } ) );
	return { pixels, points, difference: total.sum / total.count, spheres: differences.map( ( of ) => of.sum / of.count ) };

}

// Mean brightness of the pixels that face a side within 25°: sRGB, 0 to 1.
function brightness( { pixels, points }, direction ) {

	const facing = points.filter( ( p ) => dot( p.normal, direction ) > Math.cos( 25 * Math.PI / 180 ) );
	return facing.reduce( ( sum, p ) => sum + pixels[ 4 * p.pixel ], 0 ) / facing.length / 255;

}

prepare();
const server = await serve();
const browser = await chromium.launch( {
	executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
	args: [ '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist' ],
} );
let failed = 0;
const verdict = ( good, text ) => { console.log( `${ good ? 'ok    ' : 'FAILED' } ${ text }` ); failed += ! good; };
const percent = ( v ) => `${ ( 100 * v ).toFixed( 2 ) } %`;
try {

	for ( const renderer of [ 'WebGLRenderer', 'WebGPURenderer' ] ) {

		const page = await browser.newPage( { viewport: { width, height } } );
		page.on( 'console', ( message ) => { if ( message.type() === 'error' ) console.error( message.text() ); } );
		page.on( 'pageerror', ( error ) => console.error( error ) );
		await page.goto( `http://127.0.0.1:${ server.address().port }/index.html?${ renderer }` );
		await page.waitForFunction( () => window.ready, null, { timeout: 60_000 } );

		const box = { grid: '/out/box.bin', level: '/out/box.glb', spheres: [ [ 0, 1, 2 ], [ 0, 1, 0 ], [ 0, 1, - 2 ] ], radius: 0.5, albedo: 0.8, eye: [ 0.85, 1.8, 3.6 ], target: [ - 0.1, 0.8, 0 ], fov: 50 };
		const shown = await compare( page, `${ renderer }.box`, box, 'box.gdibl' );
		verdict( shown.difference <= BOUND, `${ renderer }, box: ${ percent( shown.difference ) } of white mean absolute difference over ${ shown.points.length } pixels (spheres: ${ shown.spheres.map( percent ).join( ', ' ) })` );

		for ( const side of Object.keys( SIDES ) ) {

			// From two opposite corners: each shows three sides whole.
			const found = {};
			let worst = 0;
			for ( const [ corner, eye ] of Object.entries( { a: [ 4, 3.2, 3.6 ], b: [ - 4, - 3.2, - 3.6 ] } ) ) {

				const view = { grid: `/out/side${ encodeURIComponent( side ) }.bin`, spheres: [ [ - 1.3, 0, 0 ], [ 0, 0, 0 ], [ 1.3, 0, 0 ] ], radius: 0.6, albedo: 0.8, eye, target: [ 0, 0, 0 ], fov: 36 };
				const lit = await compare( page, `${ renderer }.side${ side }.${ corner }`, view, `side${ side }.gdibl` );
				worst = Math.max( worst, lit.difference );
				for ( const [ there, direction ] of Object.entries( SIDES ) ) if ( dot( direction, eye ) > 0 ) found[ there ] = brightness( lit, direction );

			}

			const others = Math.max( ...Object.keys( SIDES ).filter( ( there ) => there !== side ).map( ( there ) => found[ there ] ) );
			verdict( found[ side ] > 0.8 && others < 0.5 && worst <= BOUND, `${ renderer }, light from ${ side }: that side ${ percent( found[ side ] ) } of white, the brightest other ${ percent( others ) }; difference ${ percent( worst ) }` );

		}
		await page.close();

	}

} finally {

	await browser.close();
	server.close();

}

process.exit( failed ? 1 : 0 );
